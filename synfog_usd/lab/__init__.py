"""How good and how fast: truths to test against, the self-test, and speed against accuracy."""

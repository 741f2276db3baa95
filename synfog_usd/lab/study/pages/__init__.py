"""What makes the documentation's drawings and tables again: `python -m synfog_usd.lab.study.pages.<name>`."""

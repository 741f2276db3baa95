"""What makes the documentation's drawings and tables again: `python -m synfog_usd.study.pages.<name>`; no verb of the
command line.
"""

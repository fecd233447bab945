"""The data folder: uploads, results and files in progress."""

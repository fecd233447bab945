"""The data folder: uploads, results and what is being written."""

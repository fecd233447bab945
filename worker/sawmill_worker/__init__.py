"""The worker: science, readers of uploads, our own files, contracts, storage, and the execution of jobs."""

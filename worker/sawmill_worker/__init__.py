"""The worker: science, formats, contracts, storage, tasks and the execution of jobs."""

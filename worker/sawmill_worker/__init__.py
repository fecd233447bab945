"""The worker: jobs and their execution, the commands' work, pictures and the watched folder."""

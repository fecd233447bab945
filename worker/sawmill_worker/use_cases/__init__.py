"""What a job and a command share: from arrays and contracts to an answer. Knows science and files, no store."""

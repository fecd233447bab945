"""Use cases that jobs and commands share: from arrays and contracts to an answer, with files and without a store."""

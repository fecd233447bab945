"""Jobs: the store of their rows, the queue, its limits and its estimates."""

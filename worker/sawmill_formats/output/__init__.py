"""Our own files: their layout, their writers and their readers."""

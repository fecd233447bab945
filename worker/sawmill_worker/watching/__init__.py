"""A watched folder, for scanners that can only write files: `sawmill watch` (docs/do/watched-folder.md)."""

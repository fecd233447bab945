"""The joint fit: the geometry and every effect that a scan shows, each with its columns, its prior and its words."""

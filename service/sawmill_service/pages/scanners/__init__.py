"""Pages of scanners: all of them, one of them, its history, settings and schedules."""

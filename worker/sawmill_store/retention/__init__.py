"""Rules of retention, their execution, and the files that no row names any more."""

"""From a raw stack to sinograms: line integrals, corrections row by row, and the alignment of views."""

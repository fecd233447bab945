"""Faults and effects in a scan: the evidence for each, the adjustment, and the sentence that reports it."""

"""Sinograms: their air, noise, faulty cells, hardening and missing rays."""

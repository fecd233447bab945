"""The program `sawmill`: command line, doctor, demo and example resources."""

"""The program `sawmill`: its command line, doctor, demo and example resources."""

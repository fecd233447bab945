"""Kinds of jobs, commands and pictures: what a mill does with scans."""

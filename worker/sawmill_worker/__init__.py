"""Kinds of jobs and commands: what a mill does with scans."""

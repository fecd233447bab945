"""The rows on which jobs work: the input of a job, its output, and the effects of its end."""

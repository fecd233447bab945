"""One file a kind of job: load, compute, store. The only place that knows science and storage together."""

"""One thin function a job kind: load, compute, store. The only place that knows science and storage together."""

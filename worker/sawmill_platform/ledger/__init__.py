"""Events and the audit: rows that are only added, in the transaction of the change itself."""

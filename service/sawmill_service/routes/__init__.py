"""Routes, a module for each resource. A route decides nothing: it validates, calls the store, shapes the answer."""

"""Pages for people: a module for each page, with its routes and the values for its template. A page decides nothing."""

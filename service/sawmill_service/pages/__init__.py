"""Pages for people: a module for each page, with its routes and the values of its template. A page decides nothing."""

"""The pages for people: one module a page, with its routes and what its template shows. They decide nothing."""

"""Tests of the store run on each database in turn, but for those that are about one, or about files alone."""

import pytest

sqlite_alone = pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
postgresql_alone = pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)

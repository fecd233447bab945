"""From a raw stack to sinograms: faulty cells, rings, and views that lost rows."""

"""Which poses to measure: criteria, certified relaxations, and designs."""

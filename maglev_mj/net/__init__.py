"""Links between programs: UDP, serial lines, addresses, and the tag by which each end knows the other."""

"""Links between programs: UDP, serial lines, addresses, authentication."""

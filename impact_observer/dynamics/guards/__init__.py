"""Event location: the first root of a gap, a load or a contact speed, none of them missed."""

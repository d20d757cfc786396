"""What a record leaves open: the stems and plants that fit as well, and the 95 % ranges in the record's scale."""

"""Reading and cleaning what plants record."""

"""The loop as CasADi expressions, and the seam over IPOPT."""

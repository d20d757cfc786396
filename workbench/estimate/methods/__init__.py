"""Methods beside the profile: the paper's two steps, the joint program, the complementarity form."""

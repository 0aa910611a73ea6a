"""Losses: one unweighted term of the objective a file. Their default weights and layers are the paper's."""

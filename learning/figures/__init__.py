"""The paper's figures, drawn from a training set, weights and results."""

"""Value maps against ground truth: what `vantage evaluate maps` measures."""

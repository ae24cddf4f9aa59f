"""How often methods are right about unseen examples: what `vantage evaluate` measures (paper, Table I)."""

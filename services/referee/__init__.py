"""The referee: the rules, the step clock, the catch."""

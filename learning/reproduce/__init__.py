"""The whole study from nothing: stages, each a `vantage` command, and the results page made of what they leave."""

"""Ways to tell whether a plan ends in a catch, behind one interface: `METHODS` in `learning.methods.table` lists them."""

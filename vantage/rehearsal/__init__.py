"""The physical world rehearsed: what cameras would see, and robots that slip and lag. Nothing of a real table imports it."""

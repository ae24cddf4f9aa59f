"""The rehearsal: stands for a physical table, with robots that slip and lag and cameras that err."""

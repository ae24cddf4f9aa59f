"""What is said between the driver and a robot on a serial line."""

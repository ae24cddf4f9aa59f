"""The driver: carries commands out with the wheels of real robots, closed on their tracked poses."""

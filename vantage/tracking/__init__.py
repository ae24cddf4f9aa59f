"""From camera frames to poses, layout, depth and colour: pure, no devices, no bus."""

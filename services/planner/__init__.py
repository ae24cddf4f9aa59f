"""The planner: A* to 121 goals, value map, goal, and the hider's low-level controller."""

"""The console: the page in the browser, and the human who plays the hider there."""

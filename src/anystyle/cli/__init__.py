"""For programs on the command line: arguments, composed configurations, progress, and errors in one line."""

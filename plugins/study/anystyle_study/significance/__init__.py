"""The built-in tests of a user study, one plugin a file."""

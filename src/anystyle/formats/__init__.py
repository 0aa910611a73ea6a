"""The file formats of Gaussian scenes that the core reads and writes."""

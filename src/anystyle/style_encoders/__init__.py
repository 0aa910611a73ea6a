"""Style encoders: images and texts in one space."""

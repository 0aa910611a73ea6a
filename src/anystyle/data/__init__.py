"""Where scenes and styles come from: photographs, videos, paintings and a procedural world."""

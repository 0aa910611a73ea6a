"""Reading scenes and styles: photographs, videos, stored cameras, style images and captions."""

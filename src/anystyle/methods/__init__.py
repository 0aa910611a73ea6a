"""From an encoded scene and a style to stylized Gaussians: the single pass, and colours of fitted Gaussians."""

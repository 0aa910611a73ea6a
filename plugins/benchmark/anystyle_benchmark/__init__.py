"""A versioned benchmark of 3D stylization: tracks, methods in processes of their own, a judge, and a site."""

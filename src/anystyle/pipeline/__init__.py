"""From a configuration to a running model: assembling, weights, groups of views, refinement, memory."""

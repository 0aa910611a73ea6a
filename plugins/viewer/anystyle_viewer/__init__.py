"""The live viewer: a scene in the browser, restyled while one looks; needs the extra ``viewer``."""

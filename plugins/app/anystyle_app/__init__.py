"""A Gradio app that makes scenes; needs the extra ``app``."""

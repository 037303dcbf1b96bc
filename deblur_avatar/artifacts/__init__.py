"""Artifacts: what flows between stages; one module each, read in the order of the pipeline.

Images are 8-bit sRGB; mattes are 8-bit coverage, 255 for a pixel the person fills. Angles in
radians, lengths in metres, times in seconds. World axes are the source's own; cameras are OpenCV's.
"""

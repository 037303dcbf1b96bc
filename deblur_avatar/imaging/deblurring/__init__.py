"""Deblurring in the picture, before anything is fitted: one seam, several kinds."""

"""People filmed by a ring of cameras, in the raw layout of ZJU-MoCap.

Source: Peng et al., "Neural Body", CVPR 2021, and the description of its data.
"""

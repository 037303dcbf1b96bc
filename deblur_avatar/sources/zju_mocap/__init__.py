"""ZJU-MoCap: people filmed by a ring of cameras, in its raw layout.

Source: Peng et al., "Neural Body", CVPR 2021, and the description of its data.
"""

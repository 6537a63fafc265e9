"""Posed RGB-D sequences on disk: one file a layout, and what they share.

`detect.read_folder` finds the layout and gives a `Sequence`: where every image lies, its pose, the
intrinsics, the depth unit. `images` reads, `resample` brings colour and depth to one camera, `upright`
turns a world that is not z up. The plug-in `source/rgbd` puts them together.
"""

"""Files of the field, one module each: pictures, COCO, MOT and MOTS, instance maps, CVAT.

`rows.TrackRows` is what a file of tracks says, whatever its format.
"""

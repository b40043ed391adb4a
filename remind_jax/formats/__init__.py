"""Files of the field: pictures, COCO, MOT and MOTS, instance maps, CVAT."""

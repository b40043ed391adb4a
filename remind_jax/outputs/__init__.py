"""What a run leaves behind: tables, MOT/MOTS/COCO files, overlay, report."""

"""Why a detection became what it became: the record of a run, reasons in words, tables."""

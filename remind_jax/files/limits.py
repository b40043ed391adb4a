"""How large what enters may be, compared before memory is taken; of detections in `static`."""

# Text
MAX_LABEL = 200  # characters of a class name
MAX_TEXT = 10_000  # characters of any other text
MAX_NAME_BYTES = 255  # of a file or folder, on nearly all disks

# Files
MAX_FILE_BYTES = 512 << 20  # of a file that is read whole
MAX_TEXT_BYTES = 64 << 20  # of MOT and MOTS text: some 15 times that in memory
MAX_XML_BYTES = 256 << 20
MAX_YAML_BYTES = 256 << 10  # a second or two
MAX_LINE_BYTES = 32 << 20
MAX_ROWS = 10_000_000
MAX_MAPPINGS = 4_000_000  # in a JSON file: as records these take up to about a gibibyte
MAX_ITEMS = 30_000_000  # in a JSON file, likewise
MAX_UNIQUE_BYTES = 64 << 20  # of JSON whose keys are compared: half a second
MAX_VALUES = 100_000  # in a mapping that came otherwise; aliases of YAML count as often as used
MAX_DEPTH = 32
MAX_INTEGER = 2**63 - 1

# Arrays
MAX_TENSOR_BYTES = 64 << 30  # of a file of weights or a memory, which is as large as its arrays
MAX_NPZ_BYTES = 1 << 30  # of all members together, as they are in memory
MAX_NPZ_RATIO = 20  # or so often the bytes of the file, where that is more
MAX_MEMBERS = 10_000

# Pictures, masks, boxes
MAX_SIDE_PX = 1 << 16
MAX_PIXELS = 1 << 28  # of a frame
MAX_PICTURE_PIXELS = 1 << 26  # of a picture or video that is decoded: 8192 x 8192
MAX_MASK_PIXELS = 1 << 26  # of a picture that a run-length code claims
MAX_MASK_BYTES = 1 << 30  # of all masks of one frame
MAX_COORDINATE_PX = 1e5
MAX_OUTLINE_PX = 2e6  # memory of a library goes by the length of an outline
MAX_FRAMES = 10_000_000  # of a scene; a larger number is a time stamp or a damaged row

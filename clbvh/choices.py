"""Names that users choose by, their numbers on the device, and defaults that are no settings.

Imports nothing: the command line's help reads them.
"""

# Values of `view.shading`.
SHADINGS = {"lambert": 0, "lambert+shadow": 1, "normal": 2, "depth": 3, "studio": 4, "ao": 5, "path": 6, "albedo": 7}

# The shadings of the report, with one ray through the centre of each pixel. The others take samples.
REPORT_SHADINGS = ("lambert", "lambert+shadow", "normal", "depth")

# Those whose samples are noisy.
LIT_SHADINGS = ("studio", "ao", "path")

# How linear light becomes a colour from 0 to 1, before the encoding as sRGB.
TONE_CURVES = {"linear": 0, "filmic": 1}

# The sides from which a picture shows the whole, in the order of a contact sheet.
STANDARD_VIEWS = ("front", "right", "back", "left", "top", "bottom", "iso")

# Of `render_images`.
DEFAULT_CHANNELS = ("rgb", "alpha", "depth", "normal", "instance_id")

# Of `render_turntable`.
DEFAULT_FRAMES = 72
DEFAULT_FRAME_RATE = 25.0

# Pixels of each view of `contact_sheet`.
SHEET_WIDTH, SHEET_HEIGHT = 400, 300

# Triangles of a shard, on average at most: with its tree and its device arrays one takes about 4 GB.
DEFAULT_SHARD_TRIANGLES = 20_000_000

# The most bins along an axis, and the most primitives of a leaf, that a builder can be asked for.
MAX_BINS, MAX_LEAF_SIZE = 64, 255

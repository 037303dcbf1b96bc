"""What a page says of its content, taken out of its file."""

import base64
import gzip
import json
import re
from typing import Any


def header_of(page: bytes) -> dict[str, Any]:
    (text,) = re.findall(rb'octet-stream">([^<]*)</script>', page)
    content = gzip.decompress(base64.b64decode(text))
    return json.loads(content[4 : 4 + int.from_bytes(content[:4], "little")])

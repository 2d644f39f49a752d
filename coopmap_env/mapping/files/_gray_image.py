"""Gray values and opacity of image files, which are opened within the limits on sizes.

PGM and PPM files are read here: Pillow takes seconds for a million pixels where the largest value
is not 255 or the pixels are text. All other formats are Pillow's.
"""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.limits import check_cells

GrayImage = tuple[NDArray[np.float64], NDArray[np.bool_] | None]
"""Gray values from 0 to 255, shape (rows, columns), and which pixels are opaque; None if all are.
The gray value of a colour is the mean of its channels."""

_GAP = rb"(?:\s|#[^\r\n]*[\r\n])+"
_PNM_HEADER = re.compile(rb"P([2356])" + 3 * (_GAP + rb"(\d{1,9})") + rb"\s")
_PILLOW_READERS = (
    (b"\x89PNG\r\n\x1a\n", "PngImagePlugin", "PngImageFile"),
    (b"P", "PpmImagePlugin", "PpmImageFile"),
    (b"BM", "BmpImagePlugin", "BmpImageFile"),
    (b"GIF8", "GifImagePlugin", "GifImageFile"),
    (b"\xff\xd8", "JpegImagePlugin", "JpegImageFile"),
)
_FORMATS = "PGM, PNG, PPM, PBM, BMP, GIF or JPEG"


def decode_gray_image(content: bytes) -> GrayImage:
    """Decode the content of an image file: PGM, PNG, PPM, PBM, BMP, GIF or JPEG.

    Values of more or fewer than 8 bits are scaled to the range from 0 to 255, and not rounded.

    Raises
    ------
    ValueError
        If the image is broken, of another format or has too many pixels.
    ImportError
        With the pip command, if Pillow is not installed and the image is not of PGM or PPM.
    """
    header = _PNM_HEADER.match(content)
    if header:
        return _decode_pnm(content, header), None
    for signature, module, reader in _PILLOW_READERS:
        if content.startswith(signature):
            return _decode_with_pillow(content, module, reader)
    raise ValueError(f"expected an image of format {_FORMATS}")


def _decode_pnm(content: bytes, header: re.Match[bytes]) -> NDArray[np.float64]:
    """Gray values of a PGM or PPM file, text or binary."""
    kind, width, height, largest = map(int, header.groups())
    if min(width, height) == 0 or not 1 <= largest <= 65535:
        raise ValueError(f"{width} x {height} pixels of at most {largest} are no image")
    check_cells((width, height), "the image")
    shape = (height, width, 3 if kind in (3, 6) else 1)
    count = width * height * shape[2]
    if kind in (2, 3):
        values = _read_numbers(content[header.end() - 1 :], count)
    else:
        dtype = np.dtype(np.uint8 if largest < 256 else ">u2")
        # a line end of Windows after the header is two bytes
        extra = len(content) - header.end() - count * dtype.itemsize
        skip = extra == 1 and content[header.end() - 1 : header.end() + 1] == b"\r\n"
        values = np.frombuffer(content, dtype, count, header.end() + skip)
    if values.max() > largest:
        raise ValueError(f"a pixel has the value {values.max()}, more than the largest, {largest}")
    total = values.reshape(shape).sum(axis=2, dtype=np.float64)
    return np.asarray(total * (255 / shape[2]) / largest)


def _read_numbers(text: bytes, count: int) -> NDArray[np.int64]:
    text = re.sub(rb"#[^\r\n]*", b"", text)
    if re.search(rb"[^\d\s]", text):
        raise ValueError("expected numbers as text")
    if len(text) < 2 * count:  # a number and the space before it
        raise ValueError(f"expected {count} pixels, got fewer")
    values = np.fromstring(text.decode(), np.int64, sep=" ", count=count)
    return np.asarray(values)


def _decode_with_pillow(content: bytes, module: str, reader: str) -> GrayImage:
    # not `PIL.Image.open`, which has a limit of its own and formats that call other programs
    plugin = import_optional(f"PIL.{module}", "maps")
    try:
        image = getattr(plugin, reader)(io.BytesIO(content))
        check_cells(image.size, "the image")
        return _gray_and_opaque(image)
    except Exception as error:  # Pillow raises what its plugins and zlib raise
        raise ValueError(f"broken image: {str(error) or type(error).__name__:.500}") from error


def _gray_and_opaque(image: Any) -> GrayImage:
    transparent = image.info.get("transparency")
    if image.mode == "F":
        raise ValueError("expected integers as gray values, not floats")
    if image.mode.startswith("I"):  # 16 bits per pixel
        gray = np.asarray(image)
        return gray / 257.0, None if transparent is None else gray != transparent
    if transparent is None and image.mode in ("1", "L"):
        return np.asarray(image.convert("L")).astype(np.float64), None
    if isinstance(transparent, int | tuple):
        image.info["transparency"] = _to_8_bits(transparent, image.tile[0][3])
    pixels = np.asarray(image.convert("RGBA"))
    return pixels[:, :, :3].sum(axis=2, dtype=np.float64) / 3.0, pixels[:, :, 3] == 255


def _to_8_bits(transparent: int | tuple[int, ...], raw_mode: Any) -> int | tuple[int, ...]:
    """A PNG's transparent gray value or colour, which Pillow does not scale with the pixels."""
    if isinstance(transparent, tuple):
        return tuple(value >> 8 for value in transparent) if raw_mode == "RGB;16B" else transparent
    return transparent * {"L;2": 85, "L;4": 17}.get(raw_mode, 1)

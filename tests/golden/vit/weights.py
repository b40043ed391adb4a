"""Deterministic, non-degenerate weights and images for the vision-transformer goldens. NumPy only.

Every number is a function of (key name, flat C-order index) through an integer hash, so any
implementation, in any layout, can rebuild the very same float32 values without a stored file.
"""

import numpy as np


def key_seed(name):
    """64-bit FNV-1a of the UTF-8 key name."""
    h = 0xCBF29CE484222325
    for b in name.encode("utf-8"):
        h = ((h ^ b) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return h


def uniform(name, count):
    """float64 values in the open interval (-1, 1), `count` of them, odd multiples of 2**-22."""
    with np.errstate(over="ignore"):
        z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = z + np.uint64(key_seed(name))
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    top = (z >> np.uint64(42)).astype(np.int64)  # 22 bits
    return ((2 * top + 1) - (1 << 22)) / float(1 << 22)  # exact in float32 and float64


def tensor(name, shape):
    """The golden value of the parameter `name` (official key names, see README) as float32."""
    shape = tuple(int(s) for s in shape)
    u = uniform(name, int(np.prod(shape))).reshape(shape)
    leaf = name.split(".")[-1]
    part = name.split(".")[-2] if "." in name else ""
    if part.startswith(("norm", "cls_norm", "local_cls_norm")):
        v = 1.0 + 0.3 * u if leaf == "weight" else 0.2 * u
    elif leaf == "gamma":  # layer scale: both signs, clearly not constant
        v = 0.6 + 0.5 * u
    elif leaf in ("cls_token", "storage_tokens", "register_tokens", "mask_token"):
        v = 1.0 * u
    elif leaf == "pos_embed":
        v = 0.8 * u
    elif leaf == "bias":
        v = 0.3 * u
    elif leaf == "weight":
        fan_in = int(np.prod(shape[1:]))
        gain = 2.0 if part == "qkv" else 1.2  # wider logits, so that the softmax is not flat
        v = gain * np.sqrt(3.0 / fan_in) * u
    else:
        raise KeyError(name)
    return v.astype(np.float32)


def state_dict(shapes):
    """{official key: shape} -> {official key: float32 array}; buffers are skipped."""
    return {k: tensor(k, s) for k, s in shapes.items() if not k.endswith(("bias_mask", "periods"))}


def image(name, height, width, batch=1):
    """Already normalised input, float32 [batch, 3, height, width], roughly unit variance.

    A smooth part plus hashed noise: 0.9 * triangle waves + 0.7 * noise.
    """
    n = uniform("image." + name, batch * 3 * height * width).reshape(batch, 3, height, width)
    # the smooth part uses a small integer table instead of sin(), so that it is exact everywhere
    tri = np.abs((np.arange(64) % 64) - 32) / 16.0 - 1.0  # triangle wave in [-1, 1]
    y = np.arange(height)[:, None]
    x = np.arange(width)[None, :]
    planes = [tri[(3 * y + x) % 64], tri[(y + 2 * x + 20) % 64], tri[(2 * y - x + 41) % 64]]
    smooth = np.stack([np.broadcast_to(p, (height, width)) for p in planes])[None]
    return (0.9 * smooth + 0.7 * n).astype(np.float32)


def official_shapes(
    family,
    width,
    depth,
    heads,
    patch,
    mlp="mlp",
    hidden=None,
    registers=0,
    grid=0,
    qkv_bias=True,
    local_cls_norm=False,
):
    """Key -> shape in the layout of the official .pth files (family: dinov3, dinov2, dino)."""
    d = width
    hidden = 4 * d if hidden is None else hidden
    s = {"cls_token": (1, 1, d)}
    if family == "dinov3":
        s["storage_tokens"] = (1, registers, d)
        s["mask_token"] = (1, d)
        s["rope_embed.periods"] = (d // heads // 4,)
    else:
        s["pos_embed"] = (1, grid**2 + 1, d)
        if family == "dinov2":
            s["mask_token"] = (1, d)
            if registers:
                s["register_tokens"] = (1, registers, d)
    s["patch_embed.proj.weight"] = (d, 3, patch, patch)
    s["patch_embed.proj.bias"] = (d,)
    for i in range(depth):
        b = f"blocks.{i}."
        s[b + "norm1.weight"] = s[b + "norm1.bias"] = (d,)
        s[b + "attn.qkv.weight"] = (3 * d, d)
        if qkv_bias:
            s[b + "attn.qkv.bias"] = (3 * d,)
            if family == "dinov3":
                s[b + "attn.qkv.bias_mask"] = (3 * d,)
        s[b + "attn.proj.weight"] = (d, d)
        s[b + "attn.proj.bias"] = (d,)
        s[b + "norm2.weight"] = s[b + "norm2.bias"] = (d,)
        if mlp == "mlp":
            s[b + "mlp.fc1.weight"], s[b + "mlp.fc1.bias"] = (hidden, d), (hidden,)
            s[b + "mlp.fc2.weight"], s[b + "mlp.fc2.bias"] = (d, hidden), (d,)
        elif mlp == "swiglu_split":  # DINOv3
            for w in ("w1", "w2"):
                s[b + f"mlp.{w}.weight"], s[b + f"mlp.{w}.bias"] = (hidden, d), (hidden,)
            s[b + "mlp.w3.weight"], s[b + "mlp.w3.bias"] = (d, hidden), (d,)
        else:  # "swiglu_fused", DINOv2 g/14
            s[b + "mlp.w12.weight"], s[b + "mlp.w12.bias"] = (2 * hidden, d), (2 * hidden,)
            s[b + "mlp.w3.weight"], s[b + "mlp.w3.bias"] = (d, hidden), (d,)
        if family != "dino":
            s[b + "ls1.gamma"] = s[b + "ls2.gamma"] = (d,)
    s["norm.weight"] = s["norm.bias"] = (d,)
    if local_cls_norm:
        s["local_cls_norm.weight"] = s["local_cls_norm.bias"] = (d,)
    return s


def periods(head_dim, base=100.0, rounded=False):
    """Rotary periods, float32 [head_dim // 4]; rounded: to the nearest even bfloat16."""
    k = np.arange(head_dim // 4, dtype=np.float64)
    p = (np.float64(base) ** (2.0 * k / (head_dim // 2))).astype(np.float32)
    if rounded:
        u = p.view(np.uint32)
        u = (u + np.uint32(0x7FFF) + ((u >> np.uint32(16)) & np.uint32(1))) & np.uint32(0xFFFF0000)
        p = u.view(np.float32)
    return p

"""Exact pictures of textured cards in space, by any camera with any radial distortion."""

import numpy as np
import torch
from scipy.ndimage import zoom

from anystyle.types import Cameras

SAMPLES = 2


def texture(rng, cells=(4, 8, 16, 32, 64), size=256):
    """Colours with detail of several sizes, in [0, 1]."""
    layers = [zoom(rng.random((n, n, 3)), (size / n, size / n, 1), order=1) for n in cells]
    return np.clip(0.5 + 2.2 * (np.mean(layers, axis=0) - 0.5), 0, 1)


class World:
    """Cards of random textures in front of a large wall, around the origin."""

    def __init__(self, seed=0, cards=7):
        rng = np.random.default_rng(seed)
        wall = np.array([0, 0, 2.5]), np.array([[5.0, 0, 0], [0, 5.0, 0]]), texture(rng, (8, 16, 32, 64, 128), 512)
        self.cards = [wall]
        for _ in range(cards):
            middle = np.append(rng.uniform(-1.3, 1.3, 2), rng.uniform(-0.8, 1.6))
            tilt = np.linalg.qr(np.eye(3) + 0.5 * rng.normal(size=(3, 3)))[0]
            tilt = tilt * np.sign(np.diag(tilt))
            self.cards.append((middle, rng.uniform(0.3, 0.6) * tilt[:, :2].T, texture(rng)))

    def picture(self, pose, focal, size, radial=0.0):
        """8-bit pixels of a camera at ``pose`` (world from camera)."""
        height, width = size
        offset = (np.arange(SAMPLES) + 0.5) / SAMPLES
        y = (np.arange(height)[:, None] + offset).ravel()
        x = (np.arange(width)[:, None] + offset).ravel()
        x, y = np.meshgrid((x - width / 2) / focal, (y - height / 2) / focal)
        distorted = np.sqrt(x**2 + y**2)
        straight = distorted.copy()
        for _ in range(30):
            straight = distorted / (1 + radial * straight**2)
        factor = straight / np.maximum(distorted, 1e-9)
        rays = np.stack([x * factor, y * factor, np.ones_like(x)], -1) @ pose[:3, :3].T
        color, nearest = np.full((*x.shape, 3), 0.5), np.full(x.shape, np.inf)
        for middle, sides, paint in self.cards:
            normal = np.cross(*sides)
            depth = ((middle - pose[:3, 3]) @ normal) / (rays @ normal)
            inside = depth[..., None] * rays + pose[:3, 3] - middle
            u, v = ((inside @ side) / (side @ side) for side in sides)
            hit = (depth > 0.05) & (depth < nearest) & (abs(u) < 1) & (abs(v) < 1)
            rows = ((v[hit] + 1) / 2 * len(paint)).astype(int), ((u[hit] + 1) / 2 * len(paint)).astype(int)
            color[hit], nearest[hit] = paint[rows], depth[hit]
        return (color.reshape(height, SAMPLES, width, SAMPLES, 3).mean((1, 3)) * 255).round().astype(np.uint8)


def arc(num_views, degrees, distance=3.0):
    """Cameras on an arc in front of the origin that look at it; world from camera."""
    poses = []
    for number, turn in enumerate(np.radians(np.linspace(-degrees / 2, degrees / 2, num_views))):
        eye = np.array([distance * np.sin(turn), 0.15 * np.sin(2.1 * number), -distance * np.cos(turn)])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross([0, 1.0, 0], forward)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], 1)
        poses.append(pose)
    return np.stack(poses)


def photographed(num_views, degrees=40, focal=200.0, size=(168, 192)):
    """Photographs of the world from an arc, and their cameras."""
    poses = arc(num_views, degrees)
    pictures = torch.from_numpy(np.stack([World().picture(pose, focal, size) for pose in poses]))
    lens = torch.tensor([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]]).expand(1, num_views, 3, 3)
    return pictures.movedim(-1, 1).float() / 255, Cameras(torch.from_numpy(poses).float()[None], lens.clone(), size)


def panorama(num_views, degrees, distance=3.0):
    """One camera that turns without moving."""
    poses = np.tile(np.eye(4), (num_views, 1, 1))
    poses[:, 2, 3] = -distance
    for pose, turn in zip(poses, np.radians(np.linspace(-degrees / 2, degrees / 2, num_views)), strict=True):
        pose[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)
    return poses

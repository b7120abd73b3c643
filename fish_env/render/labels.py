"""Layout of a picture, in pixels, and its labels: speed and time, the scale, the meaning of the muscles' colours."""

from functools import lru_cache
from typing import NamedTuple

import pygame

from fish_env.scene.frame import Frame
from fish_env.scene.look import PALETTE
from fish_env.scene.skin import CONTRACTED, FLANK, LEVELS

WIDTH, HEIGHT = 640, 480  # of the standard picture, to which the other numbers belong
OVER = 2  # drawn so many times larger, then scaled down: smooth edges
UNIT = 240  # a body length
CENTRE = (320, 220)  # the fish
PANEL = pygame.Rect(428, 350, 200, 118)  # the second view
SIDE_UNIT = 165  # a body length there
NUMBERS = pygame.Rect(12, 12, 132, 76)  # the card with speed and time
SCALE = pygame.Rect(12, HEIGHT - 92, UNIT + 24, 80)  # the card with the scale and the colours of the muscles
INK, FOAM = PALETTE["command"], (255, 255, 255)
FINE = 4  # letters are drawn so many times larger, for even spacing
COARSE = 100  # pixels a body length, below which a skin is coarse
SMALLEST = 13  # height of letters
NAMES = {"above": "from above", "side": "from the side", "follow": "from above, nose up"}
"""What each camera sees, in words."""


class Format(NamedTuple):
    """Size of a picture, pixels, its camera, a key of NAMES, and whether it has numbers and a second view."""

    width: int = WIDTH
    height: int = HEIGHT
    camera: str = "above"
    panel: bool = True

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    @property
    def unit(self) -> float:
        """Pixels a body length: the shorter side of the picture is two."""
        return UNIT * min(self.size) / HEIGHT

    @property
    def levels(self) -> int:
        """Subdivisions of a fish's skin: few in a small picture."""
        return 1 if self.unit < COARSE else LEVELS

    @property
    def part(self) -> float:
        """Size of the labels, over that in the standard picture."""
        return min(self.width / WIDTH, self.height / HEIGHT)

    @property
    def centre(self) -> tuple[float, float]:
        """The pixel of the fish: the middle, or a little higher above the labels."""
        return self.width / 2, self.height / 2 - (HEIGHT / 2 - CENTRE[1]) * self.part * self.panel

    def place(self, rect: pygame.Rect) -> pygame.Rect:
        """Where a part of the standard picture lies in this one, as far from the nearest corner."""
        x, y, width, height = (round(self.part * number) for number in rect)
        if rect.centerx > WIDTH / 2:
            x = self.width - round(self.part * (WIDTH - rect.x))
        if rect.centery > HEIGHT / 2:
            y = self.height - round(self.part * (HEIGHT - rect.y))
        return pygame.Rect(x, y, width, height)


def enlarged(rect: pygame.Rect) -> pygame.Rect:
    """The same place on the larger canvas."""
    return pygame.Rect(*(OVER * number for number in rect))


def draw_labels(picture: pygame.Surface, frame: Frame, form: Format, other: str) -> None:
    """Draw all labels on the finished picture; `other` is the camera of the second view."""
    picture.blit(legend(form.size), (0, 0))
    part, numbers, panel = form.part, form.place(NUMBERS), form.place(PANEL)
    for words, size, x, y in (
        (format_number(frame.speed), 38, 10, 8),
        ("BL/s", 19, 68, 19),
        (format_number(frame.time), 26, 10, 46),
        ("s", 19, 68, 50),
    ):
        picture.blit(text(words, round(part * size)), (numbers.x + round(part * x), numbers.y + round(part * y)))
    picture.blit(text(NAMES[other], round(17 * part), FOAM), (panel.x + round(9 * part), panel.y + round(8 * part)))
    seen = NAMES[form.camera]
    above = text(f"{frame.task.replace('_', ' ')}, {seen}" if frame.task else seen, round(17 * part))
    picture.blit(above, (form.width - round(16 * part) - above.get_width(), round(16 * part)))


def draw_caption(picture: pygame.Surface, words: str, form: Format) -> None:
    """Draw a short remark at the top of the picture, beside the numbers if there are any."""
    left, top = form.place(NUMBERS).topright if form.panel else (0, 0)
    corner = (left + round(12 * form.part), top + round((8 if form.panel else 12) * form.part))
    picture.blit(text(words, max(SMALLEST, round(26 * form.part))), corner)


def format_number(value: float) -> str:
    """A number with two decimals, or a few letters for a large one."""
    return f"{value:.2f}" if abs(value) < 1e5 else f"{value:.0e}"


@lru_cache(maxsize=512)
def text(words: str, size: int, colour=INK) -> pygame.Surface:
    """Words as a picture. Pictures, unlike fonts, outlive `pygame.quit`."""
    pygame.font.init()
    large = pygame.font.Font(None, FINE * size).render(words, True, colour)
    return pygame.transform.smoothscale(large, (large.get_width() // FINE, large.get_height() // FINE))


@lru_cache(maxsize=4)
def legend(size: tuple[int, int]) -> pygame.Surface:
    """Parts that are the same in every picture of a size: the cards, the scale, and the colours of the muscles."""
    form = Format(*size)
    part, bar = form.part, round(form.unit)
    large = pygame.Surface((OVER * form.width, OVER * form.height), pygame.SRCALPHA, 32)
    card = form.place(SCALE)
    card.width = bar + round(24 * part)
    for each in (form.place(NUMBERS), card):
        pygame.draw.rect(large, (*FOAM, 96), enlarged(each), border_radius=round(20 * part))
    pen, foot, inside = max(1, round(4 * part)), round(26 * part), card.x + round(12 * part)
    left, low = OVER * inside, OVER * (form.height - foot)
    right = left + OVER * bar
    pygame.draw.line(large, INK, (left, low), (right, low), pen)
    for x in (left, right):
        pygame.draw.line(large, INK, (x, low - 9 * part), (x, low + 9 * part), pen)
    for x in range(left, right):
        colour = FLANK + (x - left) / (right - left) * (CONTRACTED - FLANK)
        pygame.draw.line(large, colour.astype(int).tolist(), (x, low - 74 * part), (x, low - 58 * part))
    picture = pygame.transform.smoothscale(large, size)
    for words, x, y in (("relaxed", 0.0, 80), ("muscle", 0.5, 80), ("contracted", 1.0, 80), ("1 body length", 0.5, 45)):
        image = text(words, round(18 * part))
        picture.blit(image, (inside + x * (bar - image.get_width()), form.height - round(y * part)))
    return picture

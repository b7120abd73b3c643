"""Layout of a picture, in pixels, and its labels: speed and time, the scale, the meaning of the muscles' colours."""

from functools import lru_cache

import pygame

from fish_env.render.frame import Frame
from fish_env.render.skin import CONTRACTED, FLANK

WIDTH, HEIGHT = 640, 480
OVER = 2  # drawn so many times larger, then scaled down: smooth edges
UNIT = 240  # a body length, from above
CENTRE = (320, 220)  # the fish, from above
PANEL = pygame.Rect(428, 350, 200, 118)  # the view from the side
SIDE_UNIT = 165  # a body length, from the side
NUMBERS = pygame.Rect(12, 12, 132, 76)  # the card with speed and time
SCALE = pygame.Rect(12, HEIGHT - 92, UNIT + 24, 80)  # the card with the scale and the colours of the muscles
INK, FOAM, TRAIL = (16, 56, 72), (255, 255, 255), (18, 104, 134)
FINE = 4  # letters are drawn so many times larger, for even spacing


def enlarged(rect: pygame.Rect) -> pygame.Rect:
    """The same place on the larger canvas."""
    return pygame.Rect(*(OVER * number for number in rect))


def draw_labels(picture: pygame.Surface, frame: Frame) -> None:
    """Draw all labels on the finished picture."""
    picture.blit(legend(), (0, 0))
    left, top = NUMBERS.topleft
    for words, size, x, y in (
        (format_number(frame.speed), 38, 10, 8),
        ("BL/s", 19, 68, 19),
        (format_number(frame.time), 26, 10, 46),
        ("s", 19, 68, 50),
    ):
        picture.blit(text(words, size), (left + x, top + y))
    picture.blit(text("from the side", 17, FOAM), (PANEL.x + 9, PANEL.y + 8))
    above = text(f"{frame.task.replace('_', ' ')}, from above" if frame.task else "from above", 17)
    picture.blit(above, (WIDTH - 16 - above.get_width(), 16))
    if frame.caption:
        picture.blit(text(frame.caption, 26), (NUMBERS.right + 12, top + 8))


def format_number(value: float) -> str:
    """A number with two decimals, or a few letters for a large one."""
    return f"{value:.2f}" if abs(value) < 1e5 else f"{value:.0e}"


@lru_cache(maxsize=512)
def text(words: str, size: int, colour=INK) -> pygame.Surface:
    """Words as a picture. Pictures, unlike fonts, outlive `pygame.quit`."""
    pygame.font.init()
    large = pygame.font.Font(None, FINE * size).render(words, True, colour)
    return pygame.transform.smoothscale(large, (large.get_width() // FINE, large.get_height() // FINE))


@lru_cache(maxsize=1)
def legend() -> pygame.Surface:
    """Parts that are the same in every picture: the cards, the scale, and the colours of the muscles."""
    large = pygame.Surface((OVER * WIDTH, OVER * HEIGHT), pygame.SRCALPHA, 32)
    for card in (NUMBERS, SCALE):
        pygame.draw.rect(large, (*FOAM, 96), enlarged(card), border_radius=20)
    left, low = OVER * (SCALE.x + 12), OVER * (HEIGHT - 26)
    right = left + OVER * UNIT
    pygame.draw.line(large, INK, (left, low), (right, low), 4)
    for x in (left, right):
        pygame.draw.line(large, INK, (x, low - 9), (x, low + 9), 4)
    for x in range(left, right):
        colour = FLANK + (x - left) / (right - left) * (CONTRACTED - FLANK)
        pygame.draw.line(large, colour.astype(int).tolist(), (x, low - 74), (x, low - 58))
    picture = pygame.transform.smoothscale(large, (WIDTH, HEIGHT))
    for words, x, y in (
        ("relaxed", 0.0, 80),
        ("muscle", 0.5, 80),
        ("contracted", 1.0, 80),
        ("1 body length", 0.5, 45),
    ):
        image = text(words, 18)
        picture.blit(image, (SCALE.x + 12 + x * (UNIT - image.get_width()), HEIGHT - y))
    return picture

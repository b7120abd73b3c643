"""Layout of a picture, in pixels of the finished picture, and the colours of its text."""

import pygame

WIDTH, HEIGHT = 640, 480
OVER = 2  # drawn so many times larger, then scaled down: smooth edges
UNIT = 240  # a body length, from above
CENTRE = (320, 220)  # the fish, from above
PANEL = pygame.Rect(428, 350, 200, 118)  # the view from the side
SIDE_UNIT = 165  # a body length, from the side
NUMBERS = pygame.Rect(12, 12, 132, 76)  # the card with speed and time
SCALE = pygame.Rect(12, HEIGHT - 92, UNIT + 24, 80)  # the card with the scale and the colours of the muscles
INK, FOAM, TRAIL = (16, 56, 72), (255, 255, 255), (18, 104, 134)


def enlarged(rect: pygame.Rect) -> pygame.Rect:
    """The same place on the larger canvas."""
    return pygame.Rect(*(OVER * number for number in rect))

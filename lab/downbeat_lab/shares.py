"""Compares shares and growth."""

import math

Z_95 = 1.959964
"""Two-sided quantile of the normal distribution for 95 %."""


def wilson(count, total):
    """The lower and upper bound of a share by Wilson's interval (1927), at 95 %."""
    share, squared = count / total, Z_95 * Z_95
    middle = (share + squared / (2 * total)) / (1 + squared / total)
    half = Z_95 / (1 + squared / total) * math.sqrt(share * (1 - share) / total + squared / (4 * total * total))
    return middle - half, middle + half


def z_of_two(count, total, other, other_total):
    """The z of the two-proportion test with the pooled share; 0 if both shares are 0 or both are 1."""
    pooled = (count + other) / (total + other_total)
    error = math.sqrt(pooled * (1 - pooled) * (1 / total + 1 / other_total))
    return (count / total - other / other_total) / error if error else 0.0


def differ(z):
    """Whether two shares with this z differ at 95 %."""
    return not abs(z) <= Z_95


def exponent(first, last, first_size, last_size):
    """The exponent of the growth of a quantity with a size: 1 is linear."""
    return math.log(last / first) / math.log(last_size / first_size)

"""Four states with multiplicative noise; one operator, two sensors  [Sensors, section 5.3]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import multiplicative_4d
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.records import recorded, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'Four states with multiplicative noise', 'Sensors, section 5.3'
STEP=.5

@cache
def cases(quick: bool) -> list[FilteringCase]:
    return [_case(quick,n) for n in ('trigonometric','inverse_trigonometric')]

def _case(quick,name):
    system=multiplicative_4d(); s={name:system.sensors[name]()}
    P=Problem(system.model,s,gaussian([0.]*4,25*np.eye(4)))
    def draw(rng):
        return recorded(system.model,s[name],name,5*rng.standard_normal(4),STEP*np.arange(41),rng,50)
    def G(b,n): return Grid((-b,)*4,(b,)*4,(n,)*4)
    return FilteringCase(f's3 {name}','','',draw,(
      P.grid('g8 moments ext1','printed',G(20,8),KernelSettings(STEP,.5,'exponential',1,'moments'),False),
      P.grid('g8 auto','',G(20,8),KernelSettings(STEP)),
      P.grid('12, .1','',G(24,12),KernelSettings(.1)),
      P.grid('12, .05','',G(24,12),KernelSettings(.05)),
      P.grid('12, .025','',G(24,12),KernelSettings(.025)),
      P.grid('16, .1','best',G(24,16),KernelSettings(.1)),
      P.grid('16, .05','',G(24,16),KernelSettings(.05)),
      P.particles('SIR 1000','sir',1000,.01),
      P.particles('SIR 5000 one step','',5000,.5),
      P.extended(.05),P.unscented(.05),
      P.particles('optimum','optimum',10000,.02)))
def draw(exhibits):
    return {}

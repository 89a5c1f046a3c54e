"""Thin noise and a bearing: two states of which one is hardly seen  [Sensors, section 5.1]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import cubic_bearing
from pif_ros.reproduction.contenders import gaussian, Problem, uniform
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.records import recorded, Record

TITLE, SOURCE = 'Thin noise, seen by a bearing', 'Sensors, section 5.1'
STEP, START = 0.01, (0.37, 0.31)

def box_prior(box):
    def prior(f):
        inside=box.contains(f.grid.points).reshape(f.grid.shape).astype(float)
        return GridBelief(f.grid, inside).normalised()
    return prior

@cache
def cases(quick: bool):
    return [_c(.2,Grid((-.8,-.8),(.8,.8),(42,42))),_c(2.,Grid((-1.6,-1.),(1.6,1.),(62,62)))]

def _c(sy, box):
    system=cubic_bearing(sigma_y=sy); s={'arcsine':system.sensors['arcsine']()}
    P=Problem(system.model,s,uniform)
    def draw(rng):
        return recorded(system.model,s['arcsine'],'arcsine',np.array(START),STEP*np.arange(201),rng,10)
    def mult(k, box=box): return Grid(box.lower,box.upper,tuple(k*c for c in box.shape))
    big=Grid((-3.2,-1.2),(3.2,1.2),(640,480))
    big2=Grid((-3.2,-1.2),(3.2,1.2),(320,240))
    from pif_ros.core.models import Sensor
    h=s['arcsine'].function
    K=Problem(system.model,{'arcsine':Sensor(lambda x,t: np.where(box.contains(x),h(x,t),np.nan),s['arcsine'].covariance)},uniform)
    def aniso(a,b): return Grid(box.lower,box.upper,(a*box.shape[0],b*box.shape[1]))
    return FilteringCase(f's1 {sy}','','',draw,(
      P.grid('printed','printed',box,KernelSettings(STEP,.5,'exponential',2,'sampled',noise_inflation=1.),False),
      P.grid('x2','',mult(2),KernelSettings(STEP)),
      P.grid('x4','',mult(4),KernelSettings(STEP)),
      P.grid('x5','',mult(5),KernelSettings(STEP)),
      P.grid('x6','',mult(6),KernelSettings(STEP)),
      P.grid('x7','best',mult(7),KernelSettings(STEP)),
      K.particles('SIR 5000 box','',5000,STEP,box=box),
      K.particles('optimum','optimum',200000,STEP,box=box)))
def draw(exhibits):
    return {}

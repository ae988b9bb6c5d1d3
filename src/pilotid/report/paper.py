"""The numbers of the paper whose experiments a study repeats.

Berger, Zaal, Mulder and van Paassen, *Time Domain Pilot Model Identification Using Maximum
Likelihood Estimation*, AIAA 2008-7109.  They stand beside ours for comparison; nothing is
tuned to them.
"""

PAPER = "AIAA 2008-7109"
#: Order of the paper's numbers.
KEYS = ("Kvis", "tlead", "tdvis", "Kvest", "tdvest", "fnm", "dnm")
#: Fig. 3: bias and standard deviation [%] of 10 runs.
FIGURE_3 = (
    (10.8, 44.0),
    (-4.6, 51.0),
    (-2.6, 3.1),
    (-11.6, 18.0),
    (16.0, 5.7),
    (-3.4, 6.5),
    (-9.2, 4.4),
)
#: Fig. 5: error of the estimates of one record, in the parameters' units.
FIGURE_5 = (0.0144, -0.209, -0.00283, -0.377, 0.0482, -0.575, -0.0416)
#: Table 3: bias [%] by scenario.
TABLE_3 = {
    "nominal": (12.37, -13.32, -3.63, -10.50, 15.88, -3.76, -9.67),
    "disturbance-only": (-6.28, -27.20, 406.72, 41.26, 144.95, -3.59, -17.14),
    "target-only": (8.97, -40.16, -5.81, -10.89, 38.50, -11.90, -35.51),
    "disturbance-step": (0.97, -1.29, 15.12, -3.82, 19.36, 1.70, -33.60),
    "target-step": (12.61, -7.68, 0.38, -2.58, 7.81, -0.81, -9.29),
}

"""Symbols of quantities, for figures and for LaTeX."""

from __future__ import annotations

import re

#: Symbols by key; a number behind a key becomes an index.
SYMBOLS = {
    "Kvis": "K_v",
    "tlead": "T_L",
    "tlag": "T_I",
    "tdvis": r"\tau_v",
    "Kvest": "K_{vs}",
    "tdvest": r"\tau_{vs}",
    "Km": "K_m",
    "tdm": r"\tau_m",
    "wc": r"\omega_c",
    "tde": r"\tau_e",
    "tleadlow": "T_K",
    "tlaglow": "T_K'",
    "Kpf": "K_{pf}",
    "tpf": "T_{pf}",
    "Koto": "K_{oto}",
    "Kt": "K_t",
    "tlagt": "T_{I,t}",
    "tdt": r"\tau_t",
    "tlook": r"\tau_a",
    "Kf": "K_f",
    "tlagf": "T_{I,f}",
    "tlookf": r"\tau_f",
    "Kn": "K_n",
    "tlagn": "T_{I,n}",
    "tlookn": r"\tau_n",
    "fnm": r"\omega_{nm}",
    "dnm": r"\zeta_{nm}",
    "target_crossover": r"\omega_{c,t}",
    "target_phase_margin": r"\varphi_{m,t}",
    "disturbance_crossover": r"\omega_{c,d}",
    "disturbance_phase_margin": r"\varphi_{m,d}",
    "remnant_share_u": r"\sigma^2_{u,n}/\sigma^2_u",
    **{f"var_{name}": rf"\sigma^2_{name}" for name in "eux"},
    **{f"rms_{name}": rf"\mathrm{{RMS}}_{name}" for name in "eux"},
    **{
        f"var_{name}_{part}": rf"\sigma^2_{{{name},{index}}}"
        for name in "eux"
        for part, index in (("target", "t"), ("disturbance", "d"), ("remnant", "n"))
    },
}


def symbol(key: str) -> str:
    """The symbol of a quantity between dollar signs; a key without one stays as it is."""
    found = []
    for part in re.split(r"( - |[*/])", key):
        name, index = re.split(r"(\d*)\Z", part, maxsplit=1)[:2]
        own = SYMBOLS.get(part) or SYMBOLS.get(name)
        if own is None and part not in (" - ", "*", "/"):
            return key
        if own and index:
            base, underline, below = own.partition("_")
            own = f"{base}_{{{below.strip('{}')},{index}}}" if underline else f"{own}_{index}"
        found.append(own or {"*": r"\,"}.get(part, part))
    return f"${''.join(found)}$"


def with_symbols(sentence: str) -> str:
    """A sentence with the symbol of each parameter behind its key, where that comes first."""
    known = sorted((key for key in SYMBOLS if "_" not in key), key=len, reverse=True)
    named: set[str] = set()

    def shown(found: re.Match[str]) -> str:
        key = found[0]
        if key in named or found.string[found.end() :].startswith(("=", "*")):
            return key
        named.add(key)
        return f"{key} ({_plain(symbol(key))})"

    return re.sub(rf"(?<![\w*/-])(?:{'|'.join(known)})\d?(?![\w*/=-])", shown, sentence)


def _plain(formula: str) -> str:
    """A symbol as plain text."""
    greek = {r"\tau": "τ", r"\omega": "ω", r"\zeta": "ζ"}
    for name, letter in greek.items():
        formula = formula.replace(name, letter)
    return re.sub(r"[${}\\ ]", "", formula)


def unit_words(unit: str) -> str:
    """A unit as figures have it."""
    return unit.replace("^2", "²")

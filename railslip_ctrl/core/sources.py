"""Sources cited by key in docstrings, reports and derivations: "[Park2008] (45)" is equation 45 of it."""

from __future__ import annotations

from types import MappingProxyType

SOURCES = MappingProxyType(
    {
        "Park2008": (
            "S. H. Park, J. S. Kim, J. J. Choi, H. Yamazaki: Modeling and Control of Adhesion Force in Railway "
            "Rolling Stocks. IEEE Control Systems Magazine 28(5), October 2008, pp. 44-58. "
            "doi:10.1109/MCS.2008.927334"
        ),
        "CanudasDeWit1995": (
            "C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky: A new model for control of systems with "
            "friction. IEEE Transactions on Automatic Control 40(3), 1995, pp. 419-425. doi:10.1109/9.376053"
        ),
        "CanudasDeWit1999": (
            "C. Canudas de Wit, P. Tsiotras: Dynamic tire friction models for vehicle traction control. "
            "38th IEEE Conference on Decision and Control, 1999, pp. 3746-3751. doi:10.1109/CDC.1999.827937"
        ),
        "Dahl1976": (
            "P. R. Dahl: Solid friction damping of mechanical vibrations. AIAA Journal 14(12), 1976, "
            "pp. 1675-1682. doi:10.2514/3.61511"
        ),
        "WaltonMarshall1987": (
            "K. Walton, J. E. Marshall: Direct method for TDS stability analysis. IEE Proceedings D 134(2), 1987, "
            "pp. 101-107. doi:10.1049/ip-d.1987.0018"
        ),
        "Breda2005": (
            "D. Breda, S. Maset, R. Vermiglio: Pseudospectral differencing methods for characteristic roots of "
            "delay differential equations. SIAM Journal on Scientific Computing 27(2), 2005, pp. 482-495. "
            "doi:10.1137/030601600"
        ),
        "Astrom1998": (
            "K. J. Astrom, H. Panagopoulos, T. Hagglund: Design of PI controllers based on non-convex optimization. "
            "Automatica 34(5), 1998, pp. 585-601. doi:10.1016/S0005-1098(98)00011-9"
        ),
        "Bellen2003": (
            "A. Bellen, M. Zennaro: Numerical Methods for Delay Differential Equations. Oxford University Press, 2003."
        ),
        "Astrom1997": (
            "K. J. Astrom, B. Wittenmark: Computer-Controlled Systems: Theory and Design. Prentice Hall, 3rd edition, "
            "1997."
        ),
        "Hanus1987": (
            "R. Hanus, M. Kinnaert, J.-L. Henrotte: Conditioning technique, a general anti-windup and bumpless "
            "transfer method. Automatica 23(6), 1987, pp. 729-739. doi:10.1016/0005-1098(87)90029-X"
        ),
        "Astrom2021": (
            "K. J. Astrom, R. M. Murray: Feedback Systems: An Introduction for Scientists and Engineers. "
            "Princeton University Press, 2nd edition, 2021."
        ),
        "Seiler2020": (
            "P. Seiler, A. Packard, P. Gahinet: An introduction to disk margins. IEEE Control Systems Magazine "
            "40(5), 2020, pp. 78-95. doi:10.1109/MCS.2020.3005277"
        ),
        "Gryazina2008": (
            "E. N. Gryazina, B. T. Polyak, A. A. Tremba: D-decomposition technique state-of-the-art. Automation and "
            "Remote Control 69(12), 2008, pp. 1991-2026. doi:10.1134/S0005117908120011"
        ),
        "Silva2005": (
            "G. J. Silva, A. Datta, S. P. Bhattacharyya: PID Controllers for Time-Delay Systems. Birkhauser, Boston, "
            "2005."
        ),
        "Sarason1967": (
            "D. Sarason: Generalized interpolation in H-infinity. Transactions of the American Mathematical Society "
            "127, 1967, pp. 179-203."
        ),
        "Smith1957": (
            "O. J. M. Smith: Closer control of loops with dead time. Chemical Engineering Progress 53(5), 1957, "
            "pp. 217-219."
        ),
        "ManitiusOlbrot1979": (
            "A. Manitius, A. Olbrot: Finite spectrum assignment problem for systems with delays. IEEE Transactions on "
            "Automatic Control 24(4), 1979, pp. 541-553."
        ),
        "Artstein1982": (
            "Z. Artstein: Linear systems with delayed controls: A reduction. IEEE Transactions on Automatic Control "
            "27(4), 1982, pp. 869-879."
        ),
        "NormeyRico2009": (
            "J. E. Normey-Rico, E. F. Camacho: Unified approach for robust dead-time compensator design. Journal of "
            "Process Control 19(1), 2009, pp. 38-47."
        ),
        "Skogestad2003": (
            "S. Skogestad: Simple analytic rules for model reduction and PID controller tuning. Journal of Process "
            "Control 13(4), 2003, pp. 291-309. doi:10.1016/S0959-1524(02)00062-8"
        ),
        "Rotstein1991": (
            "G. E. Rotstein, D. R. Lewin: Simple PI and PID tuning for open-loop unstable systems. Industrial and "
            "Engineering Chemistry Research 30(8), 1991, pp. 1864-1869."
        ),
        "Utkin1992": "V. I. Utkin: Sliding Modes in Control and Optimization. Springer, Berlin, 1992.",
        "Tsypkin1984": "Ya. Z. Tsypkin: Relay Control Systems. Cambridge University Press, 1984.",
        "Gelb1968": (
            "A. Gelb, W. E. Vander Velde: Multiple-Input Describing Functions and Nonlinear System Design. "
            "McGraw-Hill, New York, 1968."
        ),
        "DahlehPearson1987": (
            "M. A. Dahleh, J. B. Pearson: L1-optimal compensators for continuous-time systems. IEEE Transactions on "
            "Automatic Control 32(10), 1987, pp. 889-895."
        ),
        "VanLoan1978": (
            "C. F. Van Loan: Computing integrals involving the matrix exponential. IEEE Transactions on Automatic "
            "Control 23(3), 1978, pp. 395-404. doi:10.1109/TAC.1978.1101743"
        ),
        "railtoolkit": (
            "Railtoolkit rolling-stock-data, schema 2022.05. Licence CC BY 4.0. "
            "https://github.com/railtoolkit/rolling-stock-data"
        ),
        "MacKinnon2023": (
            "J. G. MacKinnon, M. O. Nielsen, M. D. Webb: Cluster-robust inference: a guide to empirical practice. "
            "Journal of Econometrics 232(2), 2023, pp. 272-299. doi:10.1016/j.jeconom.2022.04.001"
        ),
        "ChandlerBate2007": (
            "R. E. Chandler, S. Bate: Inference for clustered data using the independence loglikelihood. "
            "Biometrika 94(1), 2007, pp. 167-183. doi:10.1093/biomet/asm015"
        ),
    }
)
"""Full references by key."""


def cite(key: str, where: str = "") -> str:
    """Return "[key] where"; raises KeyError for a key that is not in `SOURCES`."""
    SOURCES[key]
    return f"[{key}] {where}".rstrip()

"""Reserved names of KRL: well-formed names that a program cannot have.

They are keywords and predefined functions of the language, declarations of KUKA's `$CONFIG.DAT` (a KSS 8; users may
have added more), KUKA's own programs, definitions of the exported programs themselves, and names that Windows does not
allow for files. KRL ignores case.
"""

import re

from cell.errors import UsageError

MAX_NAME_LENGTH = 24
"""Most characters of a name in KRL."""

_KEYWORDS = """
abs acos and anin anout as asyptp atan2 aux axis b_and b_exor b_not b_or base bool brake c_dis c_ori c_ptp c_spl c_vel
cancel case cast_from cast_to cclose channel char cioctl circ circ_rel clear_kcpmsg confirm const const_vel continue
copen cos cread cwrite decl def default defdat deffct deftp delay digin disable distance do e3axis e3pos e6axis e6pos
else enable end enddat endfct endfor endif endloop endspline endstruc endswitch endtp endwhile enum exists exit ext
extfct extfctp extp false for forward frame get_decl_place get_sig_inf get_system_data global goto halt home if import
in ini int interrupt inv_pos inverse invertframe is ismessageset key lin lin_rel load load_def lock loop maximum mbx_rec
minimum module msec no_ovlp not nul off on onforceoff or out path peri persist pos post prio priority prn pto ptp
ptp_rel public pulse real release repeat resume return scirc scirc_rel sec seq set_kcpmsg set_system_data sig signal
sin slin slin_rel spl spline splin sps sptp sptp_rel sqrt sread statemachine stop_channel stradd strclear strcomp
strcopy strdecllen strfind string strlen strtointerr struc struct stop swrite switch syn sync tan then time_block timer
to toolcor tq_state trigger true unlock until varstate varstatet wait when while with xor
"""
_CONFIG_DAT = """
act_delay act_distance act_filter adat apo_mode_t appl_run auto_ipo_m bas_command base_corr base_corr_on base_data
base_name base_type basis_sugg_t cdefault compl_group condstop_para constvel_para cor_tool_no csdefault ctrl_in_t
ctrl_out_t cvdefault dig_out_type err_to_plc extuserid extuseridwatchdog fct_in_t fct_out_t fdat fdat_act fdefault
fhome ipo_m_t last_basis last_tp_params ldat ldat_act ldefault load_a1_data load_a2_data load_a3_data load_data
m_bas_cor_on m_base_corr machine_def machine_def_t machine_frame_dat machine_frame_t machine_tool_dat machine_tool_t
max_base max_tool moduleparam_t odat odat_act odefault out_modetype out_sugg_t pdat pdat_act pdatwork pdefault pgno
pgno_error pgno_fbit pgno_fbit_refl pgno_length pgno_parity pgno_req pgno_type pgno_valid ref_pt ref_tool
reflect_prog_nr spl_name stopm_flag tdefault tm_sugg_t tool_corr tool_corr_on tool_corr_w tool_corr_w_on tool_data
tool_name tool_type tqm_tqdat_t tracecache_t trigger_para
"""
_PROGRAMS = """
bas bas_src cell cell_src h50 ir_stopm kuka_msg msg_demo msglib new_serv p00 sps userspoc usr_start user_grp vorgabe
weldctrl
"""
_EXPORTED = """
sc_at_stop sc_begin sc_clock sc_done sc_end sc_gate sc_near sc_scan sc_scanned sc_settle sc_stand sc_stop sc_timeout
sc_timer sc_tool sc_trigger sc_view
"""
_RESERVED = frozenset(f"{_KEYWORDS} {_CONFIG_DAT} {_PROGRAMS} {_EXPORTED} con".split())

_RESERVED_PATTERNS = re.compile(r"(com|lpt|x?home|channel_|up|makro|xp)\d+|xhome|def_.*")
"""Patterns: names with a number (devices, positions, signals, KUKA's user programs), and defaults of $CONFIG.DAT."""


def check_name(name: str) -> None:
    """Require a name that a KRL program can have.

    Raises:
        UsageError: if it is too long, holds other characters, begins with a digit or is reserved.
    """
    if len(name) > MAX_NAME_LENGTH:
        shown = name if len(name) <= 2 * MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}..."
        raise UsageError(f"--name {shown} has {len(name)} characters; a name in KRL has at most {MAX_NAME_LENGTH}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(
            f"--name {name or repr(name)} is not a name in KRL; it must begin with a letter and hold only letters, "
            "digits and _"
        )
    if name.lower() in _RESERVED or _RESERVED_PATTERNS.fullmatch(name.lower()):
        raise UsageError(
            f"--name {name} is reserved in KRL, in $CONFIG.DAT or in the exported program; choose another name"
        )

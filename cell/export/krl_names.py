"""Names that a program in KRL cannot have, although they are made as names are.

Words of the language and its predefined functions; what KUKA's `$CONFIG.DAT` declares for every program (a KSS 8; its
users may have added more); KUKA's own programs; what a program of ours defines itself; and names that Windows gives
no file. Capitals and small letters are the same.
"""

import re

from cell.errors import UsageError

LONGEST_NAME = 24
"""Characters of a name in KRL."""

_LANGUAGE = """
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
_CONFIG = """
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
_OURS = """
sc_at_stop sc_begin sc_clock sc_done sc_end sc_gate sc_near sc_scan sc_scanned sc_settle sc_stand sc_stop sc_timeout
sc_timer sc_tool sc_trigger sc_view
"""
_WORDS = frozenset(f"{_LANGUAGE} {_CONFIG} {_PROGRAMS} {_OURS} con".split())

_FAMILIES = re.compile(r"(com|lpt|x?home|channel_|up|makro|xp)\d+|xhome|def_.*")
"""Names with a number (devices, positions, signals, KUKA's user programs), and defaults of $CONFIG.DAT."""


def check_name(name: str) -> None:
    """Refuse what is no name of a program in KRL.

    Raises:
        UsageError: if it is too long, holds other characters, begins with a digit or is taken.
    """
    if len(name) > LONGEST_NAME:
        shown = name if len(name) <= 2 * LONGEST_NAME else f"{name[:LONGEST_NAME]}..."
        raise UsageError(f"--name {shown} has {len(name)} characters; a name in KRL has at most {LONGEST_NAME}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(
            f"--name {name or repr(name)} is no name in KRL; it must begin with a letter and hold only letters, digits "
            "and _"
        )
    if name.lower() in _WORDS or _FAMILIES.fullmatch(name.lower()):
        raise UsageError(f"--name {name} is a word of KRL, of $CONFIG.DAT, or of the program itself; choose another")

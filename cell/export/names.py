"""Names of programs: well-formed, and not reserved in the language.

Reserved in KRL are keywords and predefined functions, declarations of KUKA's `$CONFIG.DAT` (a KSS 8; users may have
added more), KUKA's own programs, definitions of the exported programs themselves, and names that Windows does not allow
for files. KRL and RAPID ignore case; LS has upper case only.
"""

import re

from cell.errors import UsageError
from cell.export.options import Language

MAX_NAME_LENGTH = 24
"""Most characters of a name in KRL; RAPID has 32, LS 36, and the longest suffix of a name here has 4."""

LANGUAGES = {"krl": "KRL", "rapid": "RAPID", "urscript": "URScript", "ls": "LS"}
"""Names of the languages."""

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

_OTHERS = {
    "rapid": """
alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc endrecord
endtest endtrap endwhile error exit false for from func goto if inout local mod module nostepin noview not or pers proc
raise readonly record retry return step sysmodule task test then to trap true trynext undo var viewonly while with xor
abs base bool calcrobt cjointt confl cos fine home load main moveabsj movel num pose reset robtarget set setdo sin stop
string tool0 user wobj0
""",
    "urscript": """
and break continue def elif else end enter_critical exit_critical false global halt if join kill local not or pause
return run sec struct sync thread true while xor abs acos asin atan cos d2r floor home movec movej movel movep norm
popup pose_trans program r2d sin sleep sqrt tan textmsg
""",
    "ls": """
abort aux call cnt con di do else end endfor endif fine for if jmp lbl message nul pause position pr prn r select skip
then uframe utool wait
""",
}
"""Reserved names of the other languages."""

_RESERVED_PATTERNS = re.compile(r"(com|lpt|x?home|channel_|up|makro|xp)\d+|xhome|def_.*")
"""Patterns: names with a number (devices, positions, signals, KUKA's user programs), and defaults of $CONFIG.DAT."""


def check_name(name: str, language: Language) -> None:
    """Require a name that a program in the language can have; names of tables follow KRL.

    Raises:
        UsageError: if it is too long, holds other characters, begins with a digit or is reserved.
    """
    title = LANGUAGES.get(language, "KRL")
    if len(name) > MAX_NAME_LENGTH:
        label = name if len(name) <= 2 * MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}..."
        raise UsageError(f"--name {label} has {len(name)} characters; a name in {title} has at most {MAX_NAME_LENGTH}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(
            f"--name {name or repr(name)} is not a name in {title}; it must begin with a letter and hold only "
            "letters, digits and _"
        )
    lower = name.lower()
    if title == "KRL" and (lower in _RESERVED or _RESERVED_PATTERNS.fullmatch(lower)):
        raise UsageError(
            f"--name {name} is reserved in KRL, in $CONFIG.DAT or in the exported program; choose another name"
        )
    reserved = _OTHERS.get(language, "").split()
    if lower in reserved or (title != "KRL" and re.fullmatch(r"sc[A-Z_].*|(com|lpt)\d+", name)):
        raise UsageError(f"--name {name} is reserved in {title} or in the exported program; choose another name")

"""What compiled code depends on: the compiler, and the processor that it compiles for."""

from __future__ import annotations

import llvmlite.binding
import numba


def processor_name() -> str:
    """The processor's family, as the compiler calls it; two of one name compute the same bytes."""
    return str(llvmlite.binding.get_host_cpu_name())


def compiler_version() -> str:
    """Versions of numba and of LLVM beneath it."""
    return f"{numba.__version__}, LLVM {'.'.join(map(str, llvmlite.binding.llvm_version_info))}"

"""Why a loop cycles: describing functions, the exact limit cycle, and where the two agree."""

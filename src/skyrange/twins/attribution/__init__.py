"""Attribution of effects to attacks: arms to run, outcomes to compare, and the rules that name causes."""

"""Known faults, put into a run from outside: neither the recording nor its configuration shows them.

kinds        the list: name, layer, plug-in kind, and what makes it
host         a host whose plug-ins of one kind carry a fault
perception   a missed class, a wrong label, a false one
association  one thing in pieces, two things in one
update       a wrong verdict, a verdict that never comes
language     another target graph, a provider that is down
matching     another weight, the wrong order, the wrong thing
planner      no way, another goal, a way given up for nothing
motion       wheels that slip, a robot that veers
sensors      lost depth, a pose that jumps or drifts
"""

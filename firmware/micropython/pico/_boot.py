# Mounts the file system, and puts the robot's files on a new one for the lab to edit.
import rp2
import vfs

import robot_files

_flash = rp2.Flash()
try:
    _files = vfs.VfsLfs2(_flash, progsize=256)
except OSError:  # nothing there yet
    vfs.VfsLfs2.mkfs(_flash, progsize=256)
    _files = vfs.VfsLfs2(_flash, progsize=256)
vfs.mount(_files, "/")
for _name, _text in robot_files.FILES.items():
    try:
        open(_name).close()
    except OSError:
        with open(_name, "w") as _file:
            _file.write(_text)

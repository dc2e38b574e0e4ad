/* SQLite's view of a remote object (remote.h): a file system that only reads. Internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_STORE_REMOTE_H
#define LOD_STORE_REMOTE_H

#include <sqlite3.h>

struct remote;

/* Name of this file system, for sqlite3_open_v2. Its paths are /proc/self/fd/N, where N is a file
 * of blocks. NULL: out of memory. */
const char *store_remote_vfs(void);
/* The reader of a database that was opened through it; borrowed. NULL: none. */
struct remote *store_remote_of(sqlite3 *db);

#endif

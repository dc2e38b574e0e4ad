/* Keeps the stores of a server: opens what can be opened, tries the rest again, and makes a new
 * catalog when something changed. The calling thread checks files. A thread of its own checks
 * addresses, so that one that does not answer delays no file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_STORES_H
#define SERVER_STORES_H

#include "server/base/config.h"
#include "server/documents/catalog.h"

struct services;
struct stores; /* any thread */

/* Opens the stores that `args` [n] ask for: files, folders, addresses. What cannot be opened is in
 * the catalog's `absent`. Addresses are looked at now if no file could be opened, for five seconds
 * together, or with `all`, as long as it takes. cfg and args are borrowed until stores_close. *out
 * has the first catalog (stores_first) until stores_give. ERR_MEM; if `args` are
 * files alone and none can be opened, the error of the first. */
enum err_code stores_open(const struct server_config *cfg, const char *const *args, size_t n,
                          size_t readers, bool all, struct stores **out, struct err *e) ERR_USE;
/* The first catalog; borrowed until stores_give. */
const struct catalog *stores_first(const struct stores *st);
/* Gives the first catalog to s, which is borrowed until stores_close. */
void stores_give(struct stores *st, struct services *s);
/* Logs what is served. From now on stores at addresses are opened as they come. ERR_MEM. */
enum err_code stores_start(struct stores *st, struct err *e) ERR_USE;
/* Waits for the thread, which may be reading from an address. *st may be NULL. */
void stores_close(struct stores **st);
/* Looks at all stores again, those of folders as they are now. Files are served anew before
 * addresses are waited for, which is for five seconds. *tried: whether stores were tried at all.
 * ERR_FORMAT, ERR_IO, ERR_NOENT of a folder, with nothing changed; the error of the first store
 * that cannot be opened, with all others changed; ERR_MEM. */
enum err_code stores_reload(struct stores *st, bool *tried, struct err *e) ERR_USE;
/* Tries again the files whose pause is over, and drops revisions whose time is over. Call it a few
 * times a second. */
void stores_tick(struct stores *st, double now_s);

#endif

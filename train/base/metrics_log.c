/* metrics.jsonl: one JSON object a line, for programs that plot or compare runs. Lines are flushed
 * at once, so the file of a running or killed job can be read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/base.h"
#include "train/base/metrics_log.h"

struct metrics_log {
    FILE *file;
    char path[FILE_PATH_MAX];
    double start_s;
};

enum err_code metrics_log_open(const char *path, bool append, struct metrics_log **out,
                               struct err *e)
{
    *out = NULL;
    struct metrics_log *m = mem_array(1, sizeof *m);
    if (!m)
        return err_set(e, ERR_MEM, "metrics.jsonl: out of memory");
    snprintf(m->path, sizeof m->path, "%s", path);
    m->start_s = clock_s();
    m->file = fopen(path, append ? "a" : "w");
    if (!m->file) {
        err_errno(e, ERR_IO, "%s: cannot open", path);
        mem_free(m);
        return ERR_IO;
    }
    *out = m;
    return ERR_OK;
}

enum err_code metrics_log_line(struct metrics_log *m, const char *event, struct json_t *members,
                               struct err *e)
{
    json_t *line = json_pack("{s:s, s:f}", "event", event, "t_s", clock_s() - m->start_s);
    char *text = NULL;
    if (line && members && !json_object_update(line, members))
        text = json_dumps(line, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(8));
    json_decref(line);
    json_decref(members);
    if (!text)
        return err_set(e, ERR_MEM, "%s: out of memory for a line", m->path);
    int bad = fprintf(m->file, "%s\n", text) < 0 || fflush(m->file);
    int why = errno;
    free(text); /* jansson's, made with malloc */
    errno = why;
    return bad ? err_errno(e, ERR_IO, "%s: cannot write", m->path) : ERR_OK;
}

void metrics_log_close(struct metrics_log **m)
{
    if (!*m)
        return;
    fclose((*m)->file);
    mem_free(*m);
    *m = NULL;
}

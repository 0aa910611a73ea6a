CREATE TABLE IF NOT EXISTS study (id TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS sessions (
    participant TEXT PRIMARY KEY, slot TEXT NOT NULL, person TEXT NOT NULL UNIQUE, token TEXT, started TEXT NOT NULL,
    finished TEXT
);
CREATE TABLE IF NOT EXISTS answers (
    id INTEGER PRIMARY KEY, received TEXT NOT NULL, participant TEXT NOT NULL, item TEXT NOT NULL,
    question TEXT NOT NULL, side TEXT NOT NULL, score INTEGER NOT NULL, seconds REAL NOT NULL, time TEXT NOT NULL,
    revision INTEGER NOT NULL, UNIQUE (participant, item, question, side, revision)
);
CREATE TABLE IF NOT EXISTS facts (
    participant TEXT NOT NULL, name TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (participant, name)
);
CREATE VIEW IF NOT EXISTS responses AS
    WITH last AS (SELECT *, max(revision) FROM answers GROUP BY participant, item, question, side)
    SELECT (SELECT id FROM study) AS study, participant, item, question, side, score, seconds, time, revision,
        CASE WHEN id = min(id) OVER (PARTITION BY participant) THEN
            (SELECT value FROM facts WHERE facts.participant = last.participant AND name = 'comment') END AS comment
    FROM last ORDER BY id;
CREATE VIEW IF NOT EXISTS people AS SELECT participant, name, value FROM facts WHERE name != 'comment';
